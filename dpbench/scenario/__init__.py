"""The one typed description of a run, and its TOML."""

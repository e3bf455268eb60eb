"""Two result folders side by side: in words and tables, and as a page."""

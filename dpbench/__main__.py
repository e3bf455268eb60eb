"""`python -m dpbench` is the command line."""

from dpbench.cli.main import main

if __name__ == "__main__":
    raise SystemExit(main())

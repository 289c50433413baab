"""`python -m dgrasp COMMAND ...`: the same as `dgrasp COMMAND ...`."""

import sys

from dgrasp.cli import main

if __name__ == "__main__":
    sys.exit(main())

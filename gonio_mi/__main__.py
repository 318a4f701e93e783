"""``python -m gonio_mi``: the program ``gonio-mi``."""

import sys

from .cli import main

if __name__ == "__main__":
    sys.exit(main())

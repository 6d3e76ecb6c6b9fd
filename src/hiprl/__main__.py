"""`python -m hiprl` is `hiprl`."""

from __future__ import annotations

import sys

from hiprl.cli.main import main

if __name__ == "__main__":
    sys.exit(main())

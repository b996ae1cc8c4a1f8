"""Run the demo: `PYTHONPATH=tools python -m demo --out out/demo`."""

import sys

from demo.run import main

if __name__ == "__main__":
    sys.exit(main())

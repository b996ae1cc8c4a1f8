"""`python -m oculus_driver.cli` is `oculus`."""

import sys

from oculus_driver.cli import main

sys.exit(main())

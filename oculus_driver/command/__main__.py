"""`python -m oculus_driver.command` is `oculus`."""

import sys

from oculus_driver.command import main

sys.exit(main())

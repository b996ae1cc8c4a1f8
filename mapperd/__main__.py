"""`python -m mapperd` is the command `mapperd`."""

import sys

from mapperd.cli import main

sys.exit(main())

"""`python -m mapperd` is the command `mapperd`."""

import sys

from mapperd.cli.mapperd import main

sys.exit(main())

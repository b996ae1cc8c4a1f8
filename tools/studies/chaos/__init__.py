"""Ten bad minutes for a daemon: everything that fails on a vehicle, at random, and no map lost."""

"""Which sonars are on the network, and what is wrong with one."""

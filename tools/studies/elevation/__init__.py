"""Which rule resolves the elevation of echoes best: several on the same pings and poses."""

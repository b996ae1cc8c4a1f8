"""The demo: one simulated dive, mapped and compared with the true surface."""

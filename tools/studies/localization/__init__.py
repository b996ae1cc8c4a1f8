"""Localization on simulated dives, and mapping of a second pass at the corrected poses."""

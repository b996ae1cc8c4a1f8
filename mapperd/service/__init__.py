"""The daemon under a service manager: it says how it goes, and is told what to do."""

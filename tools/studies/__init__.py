"""Studies: what the project measures about itself, and the reports of the documentation."""

"""The command lines and their exit codes."""

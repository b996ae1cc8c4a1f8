"""Discovery of sonars by their status broadcasts, and diagnosis of what is wrong with one."""

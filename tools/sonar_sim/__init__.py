"""A simulator of Oculus multibeam imaging sonars that needs no GPU."""

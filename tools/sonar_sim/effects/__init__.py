"""The physical effects, and the rules that choose the effects of each ping."""

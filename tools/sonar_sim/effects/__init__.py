"""The physical effects, one module each, and the rules that say which of them a ping calls for."""

"""The command `mapperctl`."""

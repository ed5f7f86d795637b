"""The commands: a module each, whose `Options` are its command line and run it."""

"""The commands, one module each; the `Options` of a module are its command-line options and run the command."""

"""The commands, one module each: the fields of a module's `Options` are the options; `run` runs the command."""

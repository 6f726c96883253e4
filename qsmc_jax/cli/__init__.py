"""The `qsmc` command line: thin; it parses, calls and prints. Heavy imports wait until a command needs them."""

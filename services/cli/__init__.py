"""The command line: one file a panel."""

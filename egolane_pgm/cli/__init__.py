"""The command `egolane`: one file per command."""

"""The command line: commands by subject; each parses, calls and prints, and imports what it needs when it runs."""

"""What a person meets at the terminal: the help page, and pipes that close early."""

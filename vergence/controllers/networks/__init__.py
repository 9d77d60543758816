"""What a network sees, how its bundle is read, and how it runs."""

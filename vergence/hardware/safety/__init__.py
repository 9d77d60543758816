"""What keeps a robot head from being hurt, whoever chooses its commands."""

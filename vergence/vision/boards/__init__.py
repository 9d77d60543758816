"""Checkerboards and ChArUco boards: corners where four squares meet."""

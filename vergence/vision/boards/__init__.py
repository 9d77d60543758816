"""Checkerboards, ChArUco boards and AprilGrids: corners where four squares meet."""

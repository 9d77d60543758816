"""Detection of checkerboards, ChArUco boards and AprilGrids by corners where four squares meet."""

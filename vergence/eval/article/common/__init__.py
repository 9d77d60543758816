"""What several experiments of the article run: closed loops, fixed views, the simulated cases."""

"""Speed and precision, measured."""

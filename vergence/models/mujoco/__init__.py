"""The head for MuJoCo and other simulators: the compiled model, what is seen in it, its exports."""

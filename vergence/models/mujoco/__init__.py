"""The head in MuJoCo and other simulators: compiled model, appearance, scene, exports."""

"""Training of learned controllers; the only folder that imports torch and Stable-Baselines3."""

"""Heads as pictures: the images of `render`, films, and the live viewer in a browser."""

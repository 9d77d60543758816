"""The cameras that a robot really has, found from photographs of a board."""

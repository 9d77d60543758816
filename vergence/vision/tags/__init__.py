"""AprilTags: found by the AprilTag library, their corners by a fit to all edges of the cells."""

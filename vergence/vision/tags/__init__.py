"""AprilTags: found by the AprilTag library, their corners by lines fitted to the edges."""

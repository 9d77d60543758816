"""Protection of a robot head from damage, whatever policy chooses its commands."""

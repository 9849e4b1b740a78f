"""Rules by which the state decides the mode, and where trajectories cross their boundaries."""

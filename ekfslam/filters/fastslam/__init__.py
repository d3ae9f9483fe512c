"""FastSLAM: a particle for each path, and in it a small filter for each landmark."""

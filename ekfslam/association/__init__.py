"""Who saw whom: decisions from innovations and their covariances, knowing no filter."""

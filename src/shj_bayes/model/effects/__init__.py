"""Physical effects beyond the base law, one small file each."""

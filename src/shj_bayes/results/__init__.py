"""Results are typed records: read, written, sealed and versioned here and nowhere else."""

"""General methods on the trials of a proof: what each says of the same recordings and the same base law."""

"""The set-up gate: whether a campaign shows what its set-up says."""

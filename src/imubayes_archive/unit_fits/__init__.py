"""Every campaign of an archive fitted with one model."""

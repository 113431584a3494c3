"""Pre-fit checks of a log, without a model."""

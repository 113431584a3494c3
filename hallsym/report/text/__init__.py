"""Results as text, one file per kind of result."""

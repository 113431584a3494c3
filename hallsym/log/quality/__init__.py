"""Whether a log can be what it says: what goes wrong in a lab, found before anything is computed from it."""

"""What commands print: results as text for a terminal."""

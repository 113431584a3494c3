"""The Hall rotary encoder, read as two voltages or as an angle: models and effects."""

"""What PX4 does: its parameters, control loops, land detector, modes and checks."""

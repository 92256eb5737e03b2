"""Learning in flight: samples from measurements, stores of points, and what the controller may use of them."""

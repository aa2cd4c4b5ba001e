"""A simulated Hokuyo scanner, as far as the tests need it."""

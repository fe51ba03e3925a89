"""What every room may use: the configuration's schema, console output, interrupts."""

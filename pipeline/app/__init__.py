"""Runs stages and tools: the command line's configuration, one way to report mistakes, sweeps."""

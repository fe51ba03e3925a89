"""Running a stage: the command line's configuration, one way to report mistakes, sweeps."""

"""Simulators that are not ours, driven by the live team over its protocol."""

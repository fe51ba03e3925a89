"""Procedural homes after ProcTHOR's method: floor plan, furnishing, house."""

"""Homes: the type that every source produces, the reader of ProcTHOR houses, and the procedural generator."""

"""Homes: the type every source ends in, the reader of ProcTHOR houses and the procedural generator."""

"""Kinds of flexible power, a folder each: copy one to add a kind."""

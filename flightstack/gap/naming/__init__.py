"""Naming the missing effects: candidates, their columns, the evidence, the search and the verdict."""

"""Barrier certificates: shapes, the condition they meet, the cover that proves it, the file and what it rests on."""

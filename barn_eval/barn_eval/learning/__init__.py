"""The learning environment: one episode at a time, or many that advance together."""

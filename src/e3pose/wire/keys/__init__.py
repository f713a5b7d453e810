"""Certificates of a site: one authority, and one certificate for the edge and each camera."""

"""Certificates of a site: one authority, one certificate for the edge and each camera."""

"""The programs of a site: edge, cameras, router, checks, web page, streams, demo."""

"""The edge server: receive, fuse, select and send around the one `pipeline.step`."""

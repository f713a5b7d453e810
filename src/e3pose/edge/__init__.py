"""The edge server: receive, fuse, select, send; around the one `pipeline.step`."""

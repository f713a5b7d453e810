"""Archives: closed hours of a store as wide Parquet, in a folder or any object store."""

"""What a run is asked to do: typed, checked once, the same from everywhere."""

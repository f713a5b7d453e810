"""What people do: states of each person and events, from the poses of a site."""

"""Activities of people: states of each person and events, from the poses of a site."""

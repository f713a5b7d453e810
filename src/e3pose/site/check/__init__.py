"""Problems of a site or a camera's machine before it runs, and their fixes."""

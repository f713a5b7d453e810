"""Which cameras look: what each would add, what hides people, and the policies that decide."""

"""Plans: how a query is answered, by which traversal, triangle test and options."""

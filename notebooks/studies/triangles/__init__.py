"""Ray-triangle tests: speed, early exits, precision, and the tables of the papers that propose them."""

"""Studies: tables, figures and claims of papers, measured again. `python -m studies` lists them."""

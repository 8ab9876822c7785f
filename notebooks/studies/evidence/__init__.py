"""From measurements to sentences: tables of the documents, results, verdicts, and the pages that are filled from them."""

"""From episodes to answers: statistics (`results`), pages, drawings, studies and the report of a run."""

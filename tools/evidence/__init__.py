"""Evidence for the safety claims: judged hands, hostile frames, random sessions."""

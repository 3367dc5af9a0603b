"""How the photographs that a radiance field is trained on come about from its rays. One model per file."""

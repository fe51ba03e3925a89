"""What an evaluation starts from: homes, labelled rows and a trained model, each made once and found again."""

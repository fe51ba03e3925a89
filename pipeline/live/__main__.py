"""What ``python -m pipeline.live`` runs."""

from pipeline.app.tool import main
from pipeline.live import process

if __name__ == "__main__":
    main(process.run, process.__doc__ or "")

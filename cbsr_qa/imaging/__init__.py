"""From images to regions and what they score: masks, blobs and contours, loads they belong to, figures of merit."""

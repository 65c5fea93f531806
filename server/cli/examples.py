"""Examples of the command line: what the help of each command shows."""

EXAMPLES: dict[str, tuple[tuple[str, str], ...]] = {
    "": (
        ("isogi engine.nhdr", "serve a volume: open the address in a browser"),
        ("isogi inspect engine.nhdr", "what isogi makes of it"),
        ("isogi render engine.nhdr -o engine.png", "a picture of it"),
    ),
    "serve": (
        ("isogi serve", "a built-in demo"),
        ("isogi serve engine.nhdr", "a volume; isogi engine.nhdr does the same"),
        ("isogi serve engine.toml --port 8080", "a scene, at another port"),
        ("isogi serve 'bold.nii.gz#time=3'", "one step of a series in time"),
    ),
    "render": (
        ("isogi render engine.nhdr -o engine.png", "512 × 512 pixels"),
        ("isogi render engine.toml -o a.webp --azimuth 40 --target-error 0.05", "until the error is 5 %"),
        ("isogi render engine.toml -o a.npy --isovalue 70 --time 30s", "radiance, after 30 seconds"),
    ),
    "reference": (("isogi reference engine.toml -o truth.npz --azimuth 40 --time 10m", "goes on where it stopped"),),
    "report": (("isogi report engine.toml -o report --deadline 10m", "open report/index.html then"),),
    "prewarm": (
        ("isogi prewarm engine.toml --isovalue 60:120:5 --views 12 --dry-run", "how long it takes"),
        ("isogi prewarm engine.toml --isovalue 60:120:5 --views 12", "13 isovalues, 12 views of each"),
        ("isogi prewarm engine.toml --continue", "goes on where it was stopped"),
    ),
    "inspect": (
        ("isogi inspect engine.nhdr", "the facts that matter"),
        ("isogi inspect engine.toml --plan", "all of them, and what will be computed"),
        ("isogi inspect engine.nhdr --picture stiffness.png", "how steep its surfaces are"),
    ),
    "convert": (
        ("isogi convert scan.tif -o scan.ome.zarr", "in chunks, with coarser levels"),
        ("isogi convert x.raw --raw 256x256x128,uint8,little -o x.ome.zarr", "bare voxels"),
    ),
    "export": (
        ("isogi export engine.toml -o engine.glb --isovalue 70", "a mesh, for Blender and the web"),
        ("isogi export engine.toml -o engine.vti --isovalue 60:120", "a volume, for ParaView"),
    ),
    "film": (
        ("isogi film engine.toml -o engine.mp4", "a whole turn, ten seconds"),
        ("isogi film engine.toml -o sweep.gif --isovalue 60:160 --length 6", "the isovalue moves"),
    ),
    "publish": (
        ("isogi publish engine.toml -o engine", "a slider of the azimuth"),
        ("isogi publish engine.toml -o engine --isovalue 60:160:20", "a slider of the isovalue"),
    ),
    "bench": (("isogi bench engine.nhdr --size 256", "half a minute"),),
    "store": (("isogi store stats", "what the user's own store holds"),),
    "store verify": (("isogi store verify", "the user's own store"),),
    "store repair": (("isogi store repair s3://bucket/light --delete", "a store elsewhere"),),
    "store stats": (("isogi store stats /light --quick", "without reading its chunks"),),
    "store prune": (
        ("isogi store prune --older-than 30d", "lists what would go"),
        ("isogi store prune --keep-gb 20 --yes", "deletes it"),
    ),
}
"""Each command, by its words after ``isogi``: lines to type, and what each is for."""

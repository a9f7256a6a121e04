"""Examples of every command: ``--help`` shows them, the reference shows them, and the tests hold them to the parser."""

EXAMPLES: dict[str, tuple[str, ...]] = {
    "demo": ("shj-bayes demo", "shj-bayes demo -o first-look"),
    "check": (
        "shj-bayes check run1.csv run2.csv",
        "shj-bayes check test.txt --columns time=1,displacement=5,force=7 --units ms,mm,N",
    ),
    "fit": (
        "shj-bayes fit run1.csv run2.csv -o results",
        "shj-bayes fit test.txt -o other --columns time=1,displacement=5,force=7 --units ms,mm,N",
        "shj-bayes fit run1.csv run2.csv -o freed --free K,gamma --priors general",
    ),
    "diagnose": (
        "shj-bayes diagnose run1.csv run2.csv -o results",
        "shj-bayes diagnose run1.csv run2.csv -o look --quick",
        "shj-bayes diagnose run1.csv -o results --without velocity",
    ),
    "campaign": (
        "shj-bayes campaign campaign.toml -o spring",
        "shj-bayes campaign campaign.toml -o spring --workers 4",
        "shj-bayes campaign campaign.toml -o spring --dask tcp://10.0.0.5:8786",
    ),
    "tables": ("shj-bayes tables -o tables",),
    "margins": ("shj-bayes margins spring", "shj-bayes margins tables"),
    "compare": (
        'shj-bayes compare tables "Zinc 70" "Zinc 70 corroded"',
        'shj-bayes compare spring bare "zinc 70 %" --json',
    ),
    "simulate": (
        "shj-bayes simulate -o made/a --K 18 --Fy 80 --dep 60",
        "shj-bayes simulate -o made/b --beta 100 --dep -60 --ratio 0.7 --rate 10 --seed 7",
    ),
    "prove": ("shj-bayes prove -n 4 -o proof", "shj-bayes prove -n 40 --seed 7 -o proof"),
    "export": ("shj-bayes export spring --to opensees",),
    "plan": (
        "shj-bayes plan results -o next",
        "shj-bayes plan results -o next --max-speed 40 --max-minutes 20",
        "shj-bayes plan results -o next --among velocity,prying",
        "shj-bayes plan -o first --priors afc --rig rig.toml",
        "shj-bayes plan --example-rig rig.toml",
    ),
    "open": ("shj-bayes open results", "shj-bayes open results --page diagnosis", "shj-bayes open spring --pdf"),
    "completion": ("shj-bayes completion bash", "shj-bayes completion zsh"),
    "doctor": ("shj-bayes doctor", "shj-bayes doctor --json"),
}

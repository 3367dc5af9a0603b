#!/bin/sh
# fern and flower at 504 x 378 in the layouts of the paper's tables: sh benchmarks/boards/llff.sh SCENES OUT
# Tuning scenes. DoF-Gaussian as the paper has it (preset short), then Tables 4 and 5 once more with LensSelect. One seed. Cut by this
# order, stated before any run: fern's tables first, flower's after them. What is finished is kept: called again, it goes on.
set -e
scenes=$1 out=$2
dofbench make-dataset llff/fern llff/flower --data-root "$scenes" --width 504 --focus 0.2,0.5,0.8 --aperture 0.5,1.0 --out "$out/data"
sed '1,5s/^method = "dofgaussian"/method = "lensselect"/' methods/dofgaussian/ablations.toml > "$out/ours.toml"
for data in "$out/data/llff-fern" "$out/data/llff-fern,$out/data/llff-flower"; do
    for table in table3 table2 table4 table5; do
        dofbench ablate --data "$data" --table $table --seeds 1 --results "$out/runs" --out "$out/tables"
    done
    for table in table4 table5; do
        dofbench ablate --tables "$out/ours.toml" --data "$data" --table $table --seeds 1 --results "$out/runs" --out "$out/ours"
    done
done

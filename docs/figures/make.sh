#!/bin/sh
# Draw every figure of docs/gallery.md and docs/skills.md from the shipped weights, or from runs/
# where that exists.  Run it from the root of the repository:  sh docs/figures/make.sh
# Each line is the command that stands under its figure; the SVG twins are not kept here.
set -e
agility-ref plot courses --out docs/figures/courses.png
agility-ref plot framework --out docs/figures/framework.png
agility-ref plot skills --preset quick --difficulty 0.3 --out docs/figures/skills.png
agility-ref plot strobe oracle --environment climb-gap --preset quick --difficulty 0.3 --out docs/figures/strobe.png
agility-ref plot strobe gen-5 --environment beam --preset quick --out docs/figures/strobe-beam.png
agility-ref plot oracle-map oracle --environment climb-gap --preset quick --out docs/figures/oracle-map.png
agility-ref plot oracle-map ps-rl-3 --environment climb-gap --preset quick --out docs/figures/selector-map.png
agility-ref plot episode walk --environment walk --preset quick --out docs/figures/episode.png
if [ -d runs/quick ]; then
  agility-ref plot curves runs/quick/gen-3/seed* runs/quick/climb/seed* runs/quick/leap/seed* runs/quick/walk/seed* --out docs/figures/curves.png
fi
agility-ref video oracle --environment climb-gap --preset quick --difficulty 0.3 --seconds 6 --fps 16 --width 400 --height 300 --quality 50 --out docs/figures/oracle.webp
agility-ref video gen-5 --environment beam --preset quick --seconds 6 --fps 16 --width 400 --height 300 --quality 50 --out docs/figures/beam.webp
for d in 0.5 1; do
  agility-ref plot strobe walk --environment walk --difficulty $d --out docs/figures/walk-$d.png
  agility-ref plot strobe climb --environment climb --difficulty $d --out docs/figures/climb-$d.png
  agility-ref plot strobe leap --environment gap --difficulty $d --out docs/figures/leap-$d.png
done
agility-ref video climb --environment climb --difficulty 1 --seconds 13 --fps 14 --width 400 --height 300 --quality 45 --out docs/figures/climb.webp
rm -f docs/figures/*.svg

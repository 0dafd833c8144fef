#!/usr/bin/env bash
# Trains a small ACT with LeRobot's trainer.
# Usage: scripts/learned/lerobot/train.sh VENV DATASET OUT STEPS SAVE_EVERY
#
# FROM names a checkpoint to start from; without it, the network is a new one. STATE sets the normalisation of the state (IDENTITY or
# MEAN_STD), RATE the largest learning rate, THREADS the threads.
set -euo pipefail
venv=$1 dataset=$2 out=$3 steps=$4 save=$5
# Nothing is downloaded: no pretrained weights, no dataset.
export HF_HUB_OFFLINE=1 OMP_NUM_THREADS=${THREADS:-1}
rate=${RATE:-5e-4}

if [ -n "${FROM:-}" ]; then
    policy=(--policy.path="$FROM")
else
    # No variational encoder, because one expert has one way to solve a scene. The network sees the wrist camera: in 32 pixels the front
    # camera does not show the object. The state is not normalised: the hand points down in all demonstrations, so two elements of its
    # quaternion have a standard deviation of 0.0005 and 0.0007, and division by that amplifies small tilts.
    policy=(
        --policy.type=act --policy.pretrained_backbone_weights=null
        --policy.input_features='{"observation.state": {"type": "STATE", "shape": [15]}, "observation.images.wrist": {"type": "VISUAL", "shape": [3, 32, 32]}}'
        --policy.chunk_size=10 --policy.n_action_steps=10 --policy.use_vae=false --policy.dim_model=128 --policy.n_heads=4
        --policy.dim_feedforward=256 --policy.n_encoder_layers=2 --policy.dropout=0
        --policy.normalization_mapping='{"VISUAL": "MEAN_STD", "STATE": "'"${STATE:-IDENTITY}"'", "ACTION": "MEAN_STD"}'
    )
fi
# The learning rate decays to the end of the training, which LeRobot's preset for ACT does not do.
"$venv/bin/lerobot-train" --dataset.repo_id=local/demos --dataset.root="$dataset" --output_dir="$out" \
    "${policy[@]}" --policy.device=cpu --policy.push_to_hub=false \
    --use_policy_training_preset=false --optimizer.type=adamw --optimizer.lr="$rate" --optimizer.weight_decay=1e-4 \
    --scheduler.type=cosine_decay_with_warmup --scheduler.peak_lr="$rate" --scheduler.decay_lr=1e-5 \
    --scheduler.num_warmup_steps=200 --scheduler.num_decay_steps="$steps" \
    --batch_size=32 --steps="$steps" --save_freq="$save" --num_workers=0

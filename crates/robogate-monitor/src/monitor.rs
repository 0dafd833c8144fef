//! The monitor of all recipes.

use std::collections::BTreeMap;

use crate::alarm::Alarm;
use crate::cycle::Cycle;
use crate::domain::Judged;
use crate::recipe::{Recipe, RecipeState};
use crate::settings::{Settings, SettingsError};

/// The monitor: takes cycles and returns alarms.
///
/// It uses no clock, no file and no random numbers. The same settings and cycles give identical alarms.
#[derive(Debug, Clone, PartialEq)]
pub struct Monitor {
    settings: Settings,
    recipes: BTreeMap<String, Recipe>,
}

/// The error for a cycle of a new recipe, if the limit of recipes is reached.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("recipe `{recipe}` is new, and {most} recipes are watched already\nHint: increase `most_recipes`")]
pub struct TooManyRecipes {
    /// The rejected recipe.
    pub recipe: String,
    /// The limit.
    pub most: u32,
}

impl Monitor {
    /// Creates a monitor without cycles.
    ///
    /// # Errors
    /// If the settings are invalid.
    pub fn new(settings: Settings) -> Result<Self, SettingsError> {
        settings.check()?;
        Ok(Self { settings, recipes: BTreeMap::new() })
    }

    /// Restores the state of a recipe, see [`Recipe::restore`].
    pub fn restore(&mut self, name: &str, state: RecipeState) {
        self.recipes.insert(name.to_owned(), Recipe::restore(name, state, &self.settings));
    }

    /// Checks that a cycle of this recipe can be accepted after `others` more new recipes.
    ///
    /// # Errors
    /// If the recipe is new and the limit is reached.
    pub fn has_room(&self, recipe: &str, others: usize) -> Result<(), TooManyRecipes> {
        let most = self.settings.most_recipes;
        if self.recipes.len() + others < most as usize || self.recipes.contains_key(recipe) {
            Ok(())
        } else {
            Err(TooManyRecipes { recipe: recipe.to_owned(), most })
        }
    }

    /// Processes one cycle, in the order of arrival. Passes raised and cleared alarms to `emit`. Returns how the
    /// parameters compare with the validated region.
    ///
    /// The cycle must have passed [`Cycle::check`]. Memory is allocated only at an alarm, for a new recipe, robot or
    /// failure mode, and when learning ends.
    ///
    /// # Errors
    /// If the recipe is new and the limit is reached.
    pub fn observe(&mut self, cycle: &Cycle, emit: &mut dyn FnMut(Alarm)) -> Result<Judged, TooManyRecipes> {
        if let Some(recipe) = self.recipes.get_mut(cycle.recipe.as_str()) {
            return Ok(recipe.observe(cycle, &self.settings, emit));
        }
        self.has_room(&cycle.recipe, 0)?;
        let mut recipe = Recipe::new(&cycle.recipe, &self.settings);
        let judged = recipe.observe(cycle, &self.settings, emit);
        self.recipes.insert(cycle.recipe.clone(), recipe);
        Ok(judged)
    }

    /// The number of recipes.
    pub fn len(&self) -> usize {
        self.recipes.len()
    }

    /// Whether there is no recipe yet.
    pub fn is_empty(&self) -> bool {
        self.recipes.is_empty()
    }

    /// The settings.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// Finds a recipe by its name.
    pub fn recipe(&self, name: &str) -> Option<&Recipe> {
        self.recipes.get(name)
    }

    /// Finds a recipe by its name, to restart it.
    pub fn recipe_mut(&mut self, name: &str) -> Option<&mut Recipe> {
        self.recipes.get_mut(name)
    }

    /// The recipes, by name.
    pub fn recipes(&self) -> impl Iterator<Item = (&str, &Recipe)> {
        self.recipes.iter().map(|(name, recipe)| (name.as_str(), recipe))
    }
}

#pragma once
// toml++ with the same settings in every source: with different ones its inline functions collide when linked.
#define TOML_EXCEPTIONS 0
#define TOML_HEADER_ONLY 1
// Its assertions on malformed keys become promises to the optimiser under NDEBUG, and hostile text breaks them: here
// they are nothing, and the errors behind them stand.
#pragma push_macro("NDEBUG")
#undef NDEBUG
#define TOML_ASSERT(expr) static_assert(true)
#include <toml++/toml.h>
#pragma pop_macro("NDEBUG")

// celadon board: a calibration board to print.

#include <cstdio>
#include <filesystem>
#include <memory>
#include <string>

#include <CLI/CLI.hpp>

#include "acquisition/calibrate/target_board.h"
#include "daemon/cli/board_sheet.h"
#include "daemon/cli/commands.h"
#include "daemon/files/atomic_file.h"

namespace celadon::cli {
namespace {

struct BoardArguments {
  std::string board, output;
};

int write_board(const BoardArguments& arguments) {
  const bool rim = arguments.board.starts_with("rim:");
  const auto board = rim ? tl::unexpected(std::string()) : TargetBoard::parse(arguments.board);
  if (!rim && !board) return fail(2, board.error());
  const std::string kind = std::filesystem::path(arguments.output).extension().string();
  if (kind != ".svg" && kind != ".pdf") {
    return fail(2, "'" + arguments.output + "' has no kind of file that can be written; name it .svg or .pdf");
  }
  const auto sheet = rim ? lay_out_rim_tags(arguments.board) : lay_out_board(*board);
  if (!sheet) return fail(2, sheet.error());
  const auto written = write_file_atomically(arguments.output, kind == ".svg" ? svg_of(*sheet) : pdf_of(*sheet));
  if (!written) return fail(4, written.error().message);
  if (rim) {
    std::printf("%s on %s: cut the tags out and glue them round the platter's rim\n", arguments.board.c_str(),
                sheet->page.c_str());
    return 0;
  }
  std::printf("%s on %s, %.0f x %.0f mm: print at 100 %%, check both rulers, measure the pitch along x and y\n",
              board->text().c_str(), sheet->page.c_str(), sheet->width_mm, sheet->height_mm);
  return 0;
}

}  // namespace

void add_board_command(CLI::App& program, Run& run) {
  auto arguments = std::make_shared<BoardArguments>();
  auto* command = program.add_subcommand("board", "Write a calibration board to print at true size (SVG or PDF).");
  command
      ->add_option("BOARD", arguments->board,
                   "chessboard:COLUMNSxROWSxSQUARE or tags:COLUMNSxROWSxSQUARE+FIRST_TAG, squares in mm, e.g. "
                   "tags:10x7x12; or rim:COUNTxSIDE, tags for the rim of the platter")
      ->required();
  command->add_option("-o,--output", arguments->output, "file to write: .svg or .pdf")->required();
  command->callback([arguments, &run] { run = [arguments] { return write_board(*arguments); }; });
}

}  // namespace celadon::cli
